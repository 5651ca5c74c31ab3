//! A user's terms in a scene: the scene's text contains their names and the values of their
//! parameters, the program adds their code.

use super::Scene;
use crate::error::{Error, Result};
use crate::models::{Central, CentralForce, Medium, Model};
use crate::parameters::{Parameter, ParameterSpec};
use crate::systems::particle_force::{ForceOnParticles, ParticleForce};
use crate::systems::term::Term;
use std::any::{Any, TypeId};
use std::collections::BTreeMap;
use std::fmt::{self, Debug};
use std::sync::Arc;

/// Values of a term's parameters by name.
pub type Values = BTreeMap<String, f64>;

/// Makes a term from the values of its parameters.
type MakeTerm<const D: usize> = Arc<dyn Fn(&Values) -> Box<dyn Term<D>> + Send + Sync>;

/// Makes a pair law from these values and the fluid of the flow.
type MakeLaw<const D: usize> = Arc<dyn Fn(&Values, Medium<D>) -> Box<dyn Model<D>> + Send + Sync>;

#[derive(Clone)]
enum Make<const D: usize> {
    Term(MakeTerm<D>),
    Law(MakeLaw<D>),
}

/// The code of one term in one dimension.
#[derive(Clone)]
struct Guest<const D: usize> {
    name: String,
    make: Make<D>,
}

/// The code of all terms of a user; scenes are compared, written and read without it.
#[derive(Clone, Default)]
pub struct Guests {
    two: Vec<Guest<2>>,
    three: Vec<Guest<3>>,
    /// Types of forces; each may be added several times.
    types: Vec<TypeId>,
}

impl PartialEq for Guests {
    fn eq(&self, other: &Self) -> bool {
        self.names() == other.names()
    }
}

impl Debug for Guests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

impl Guests {
    fn names(&self) -> Vec<&str> {
        let two = self.two.iter().map(|guest| guest.name.as_str());
        two.chain(self.three.iter().map(|guest| guest.name.as_str())).collect()
    }

    fn of<const D: usize>(&self) -> &[Guest<D>] {
        let (two, three): (&dyn Any, &dyn Any) = (&self.two, &self.three);
        let own = two.downcast_ref::<Vec<Guest<D>>>();
        own.or_else(|| three.downcast_ref()).map_or(&[], Vec::as_slice)
    }

    fn push<const D: usize>(&mut self, name: &str, make: Make<D>) {
        let guest = Guest { name: name.to_owned(), make };
        let (two, three): (&mut dyn Any, &mut dyn Any) = (&mut self.two, &mut self.three);
        if let Some(own) = two.downcast_mut::<Vec<Guest<D>>>() {
            own.push(guest);
        } else if let Some(own) = three.downcast_mut::<Vec<Guest<D>>>() {
            own.push(guest);
        }
    }
}

/// Prefixes the names of parameters with the term's name, and replaces their values by the scene's.
pub(crate) fn named(
    term: &str,
    specs: impl IntoIterator<Item = ParameterSpec>,
    values: &Values,
) -> Vec<ParameterSpec> {
    let own = |spec: ParameterSpec| {
        let value = values.get(spec.name.name()).copied().unwrap_or(spec.value);
        let name = Parameter::from(format!("{term}.{}", spec.name));
        ParameterSpec { name, value, ..spec }
    };
    specs.into_iter().map(own).collect()
}

impl Scene {
    /// Adds a force on each particle; its parameters are learned as `name.parameter`.
    pub fn add_force<F: ParticleForce>(&mut self, name: &str, force: F) {
        let number = self.guests.types.iter().filter(|id| **id == TypeId::of::<F>()).count();
        self.guests.types.push(TypeId::of::<F>());
        self.name_term(name, &force.parameters());
        fn add<F: ParticleForce, const D: usize>(
            guests: &mut Guests,
            (name, number): (&str, usize),
            force: F,
        ) {
            let own = name.to_owned();
            let make = move |values: &Values| -> Box<dyn Term<D>> {
                let specs = named(&own, force.parameters(), values);
                Box::new(ForceOnParticles::new(&own, (force.clone(), number), specs))
            };
            guests.push::<D>(name, Make::Term(Arc::new(make)));
        }
        add::<F, 2>(&mut self.guests, (name, number), force.clone());
        add::<F, 3>(&mut self.guests, (name, number), force);
    }

    /// Adds a central force between pairs of particles to the forces of the scene's model; its
    /// parameters are learned as `name.parameter`.
    pub fn add_pair_law<F: CentralForce<P>, const P: usize>(&mut self, name: &str, force: F) {
        self.name_term(name, &force.parameters());
        fn make<F: CentralForce<P>, const P: usize, const D: usize>(
            name: &str,
            force: F,
        ) -> Make<D> {
            let name = name.to_owned();
            Make::Law(Arc::new(move |values, medium| {
                Box::new(Central::new(&name, force.clone(), medium).with_values(values))
            }))
        }
        let (two, three) = (make(name, force.clone()), make(name, force));
        self.guests.push::<2>(name, two);
        self.guests.push::<3>(name, three);
    }

    /// Adds a pair law that implements [`crate::models::PairLaw`] or [`Model`], in one dimension;
    /// `make` takes the parameter values in the scene's text, and the fluid.
    pub fn add_model<const D: usize>(
        &mut self,
        name: &str,
        make: impl Fn(&Values, Medium<D>) -> Box<dyn Model<D>> + Send + Sync + 'static,
    ) {
        self.terms.entry(name.to_owned()).or_default();
        self.guests.push(name, Make::Law(Arc::new(make)));
    }

    /// Adds a term that implements its trait, in one dimension; `make` takes the parameter values
    /// in the scene's text.
    pub fn add_term<const D: usize>(
        &mut self,
        name: &str,
        make: impl Fn(&Values) -> Box<dyn Term<D>> + Send + Sync + 'static,
    ) {
        let own = self.terms.entry(name.to_owned()).or_default();
        for spec in make(own).parameters() {
            let key = spec.name.name().strip_prefix(&format!("{name}.")).map(str::to_owned);
            own.entry(key.unwrap_or_else(|| spec.name.to_string())).or_insert(spec.value);
        }
        self.guests.push(name, Make::Term(Arc::new(make)));
    }

    /// Names a term in the scene, with values for those of its parameters that have none yet.
    fn name_term(&mut self, name: &str, specs: &[ParameterSpec]) {
        let own = self.terms.entry(name.to_owned()).or_default();
        for spec in specs {
            own.entry(spec.name.to_string()).or_insert(spec.value);
        }
    }

    /// The terms that the scene names, without pair laws.
    ///
    /// # Errors
    /// [`Error::Input`] for a term without added code.
    pub(crate) fn added_terms<const D: usize>(&self) -> Result<Vec<Box<dyn Term<D>>>> {
        let guests = self.guests.of::<D>();
        if let Some(missing) =
            self.terms.keys().find(|name| !guests.iter().any(|g| g.name == **name))
        {
            return Err(Error::input(
                format!("scene {}: terms.{missing}", self.name),
                "a term whose code this program has added for this dimension",
                "none of that name",
                "call Scene::add_force, add_pair_law, add_model or add_term before the flow is built, or take the \
                 table out",
            ));
        }
        let make = |guest: &Guest<D>| match &guest.make {
            Make::Term(make) => Some(make(self.values(&guest.name))),
            Make::Law(_) => None,
        };
        Ok(guests.iter().filter_map(make).collect())
    }

    /// The pair laws that the scene names, with their names.
    pub(crate) fn added_models<const D: usize>(
        &self,
        medium: &Medium<D>,
    ) -> Vec<(String, Box<dyn Model<D>>)> {
        let make = |guest: &Guest<D>| match &guest.make {
            Make::Law(make) => {
                Some((guest.name.clone(), make(self.values(&guest.name), medium.clone())))
            }
            Make::Term(_) => None,
        };
        self.guests.of::<D>().iter().filter_map(make).collect()
    }

    fn values(&self, name: &str) -> &Values {
        static NONE: Values = Values::new();
        self.terms.get(name).unwrap_or(&NONE)
    }
}
